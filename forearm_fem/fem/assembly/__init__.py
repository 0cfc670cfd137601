"""From tissues and boundaries to the operator: real matrices, and scalars of frequency."""
