"""What single commands do beyond the chain: calls, interpolation, prediction of particles."""
