"""Joins LeRobot datasets into one: files are linked, only what numbers rows is written anew."""
