"""Force maps, their guards, pictures, films and reports."""
