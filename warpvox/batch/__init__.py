"""Many worlds as arrays: their tables, packs and lanes, and the objects in them by name."""
