"""Measuring G: sweep, device, estimation, calibration; and declaring what other people's files mean."""
