"""Reading files that others have made, and writing files whole or not at all."""
