"""Files of a results folder, and its record."""
