"""Pendulums of rigid arms."""
