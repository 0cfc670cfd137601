"""How far one transfer matrix is from another, what that means for rendering, and fitting a model to it."""
