"""Physical models: forces, contacts and simulation. Nothing here is fitted to data."""
