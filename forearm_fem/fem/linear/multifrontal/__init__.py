"""A multifrontal factorisation of complex symmetric matrices in single precision, on SciPy's BLAS.

The matrix is A = L D L^T, block by block: unknowns that are eliminated together form a *supernode*, a front is the
dense matrix of a supernode and of what it couples to, and what is left of a front is added to that of its parent in the
elimination tree (Duff and Reid, 1983; Liu, 1992). Pivots are taken inside blocks of 64 unknowns only; refinement shows
whether that was enough. decision 0009 says what it gains over MKL PARDISO.
"""
