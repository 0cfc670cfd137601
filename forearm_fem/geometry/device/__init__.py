"""Device on the limb: places, rims and element sizes."""
