"""The commands of ``forearm-fem`` by topic: each parses, calls the library and prints; heavy imports inside."""
