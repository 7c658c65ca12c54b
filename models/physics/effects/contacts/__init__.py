"""Effects that act when a ball meets another ball or a cushion."""
