"""Compiled products and sums of matrices; what each computes is tested against an obvious version."""
