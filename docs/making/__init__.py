"""What makes the documentation: pages from the code, the gallery from its case studies, one command for all of it."""
