"""Questions about a device and an arm, each with its answer: compare and fit two G, design a device."""
