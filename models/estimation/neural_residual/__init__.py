"""A small network that corrects the contact and cloth models of billiards, and its training."""
