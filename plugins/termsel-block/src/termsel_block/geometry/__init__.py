"""Where things are: the frame, the models of images, and their control."""
