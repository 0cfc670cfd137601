"""The mesh that everything after geometry works on: its shape, quality, files and refinement."""
