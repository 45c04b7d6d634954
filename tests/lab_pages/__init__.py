"""The pages of `loadid lab`: server, numbers, browser."""
