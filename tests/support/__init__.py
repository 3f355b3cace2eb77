"""What several groups of tests share: an agent in a thread, lines to it, players, a client,
and what tests on MicroPython take along."""
