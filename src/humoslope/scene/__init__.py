"""Robot, terrain and sensors as one model, and the signals read from it."""
