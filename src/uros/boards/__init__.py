"""Virtual boards: hardware, engines that run firmware on it, the build of a board's files."""
