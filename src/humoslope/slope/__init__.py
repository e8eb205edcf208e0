"""Mathematics of slopes as pure tensor functions."""
