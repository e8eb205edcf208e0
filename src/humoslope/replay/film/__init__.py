"""Video and contact sheet of a recorded walk, without a display."""
