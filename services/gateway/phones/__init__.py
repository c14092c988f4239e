"""What the gateway knows of each phone while it posts: clock, batches seen, what waits for the bus."""
