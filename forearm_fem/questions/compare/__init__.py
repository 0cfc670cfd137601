"""Distance of two transfer matrices, its meaning for rendering, and fitting a model to one."""
