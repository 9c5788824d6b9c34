"""Looking at results: pictures, films, animations, words, and the report of a batch."""
