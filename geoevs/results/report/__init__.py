"""One page that shows a whole run and opens without a network."""
