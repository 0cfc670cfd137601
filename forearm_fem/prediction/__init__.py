"""What S a builder will see on people: draws of arms and of measurements, each with its 27 S, and what they say."""
