"""The swing calibration: its samples on ramps, its fit, its file and its figure."""
