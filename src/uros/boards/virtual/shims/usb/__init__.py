"""USB devices defined by the firmware."""
