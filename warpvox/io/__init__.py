"""Safe reading of files from others, and atomic writing of our own."""
