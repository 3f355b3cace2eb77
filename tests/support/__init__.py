"""What several groups of tests share: an agent in a thread, lines to it, players and a client."""
