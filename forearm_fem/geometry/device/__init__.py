"""Where the device meets the limb: places, rims and element sizes."""
