"""Command line: parses, shows progress, prints; all work is done by the library."""
