"""A walk recorded once to a file, and the ways to look at it: in rerun, as a video, as a picture."""
