"""Pendulums of rigid arms: their motion, and what angles say of them."""
