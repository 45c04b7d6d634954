"""Which of many candidate operators made the data, all regularised alike, and where between them the load was."""
