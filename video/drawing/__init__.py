"""Drawing primitives: colours, text, masks, label placement, plans of the table."""
