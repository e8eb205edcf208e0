"""The swing calibration: walked on ramps, fitted, written and drawn."""
