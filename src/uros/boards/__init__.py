"""Virtual hardware, and boards that play what real ones once said."""
