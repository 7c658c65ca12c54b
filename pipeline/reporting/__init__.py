"""Everything that a person reads or looks at: sentences, figures, pages, recordings."""
