"""Reduced models: what spans them, how they are certified, their poles, the sweep."""
