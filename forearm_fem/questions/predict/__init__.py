"""Prediction of S for people: draws of arms, devices and measurements."""
