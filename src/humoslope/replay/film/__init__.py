"""A recorded walk as a video and a contact sheet, without a display."""
