"""Physical models of line scanners and radars in orbit, and of frame and panoramic cameras."""
