"""Drawing primitives that know nothing of a clip: colours, text, masks, label placement and plans of the table."""
