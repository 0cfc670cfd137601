"""The user's own surfaces and meshes: read, checked, cut into tissues."""
