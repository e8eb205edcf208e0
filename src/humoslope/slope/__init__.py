"""The mathematics of slopes as pure tensor functions."""
