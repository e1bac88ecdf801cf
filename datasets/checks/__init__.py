"""What can be wrong with a LeRobot folder: one module for each subject, joined by `dataset.py`."""
