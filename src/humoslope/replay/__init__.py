"""Recording of walks to files, and display of the files: in rerun, as a video, as a picture."""
