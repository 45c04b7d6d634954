"""What the data can tell of a load: Picard, decay, resolution, the start of a record."""
