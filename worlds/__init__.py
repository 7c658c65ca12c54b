"""Independent simulators that check the program: they share no code with it and run as separate processes."""
