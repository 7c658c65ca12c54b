"""Detection without a network: circles and streaks of the expected size that differ from the cloth."""
