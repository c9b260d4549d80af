"""Tables of the papers, rebuilt on simulated data, each next to the published one."""
