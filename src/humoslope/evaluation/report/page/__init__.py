"""One HTML page of a training run, or of a comparison of several."""
