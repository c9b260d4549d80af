"""Old maps: their prime meridian, and the projection that they were drawn in."""
