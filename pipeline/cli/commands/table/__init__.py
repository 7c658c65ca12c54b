"""Commands about the table of many shots: balls put back, certificates."""
