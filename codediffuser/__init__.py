"""Demonstrations, attention labels and policies for robots that follow ambiguous language."""

__version__ = "0.1.0"
