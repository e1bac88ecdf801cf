"""Ambiguous instructions: descriptive phrases, sentence templates, and the pairs they allow."""
