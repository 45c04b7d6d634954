"""One runnable file for each paper or measured record: prints its table, saves its figure."""
