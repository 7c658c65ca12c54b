"""Self-contained HTML pages and their templates; the sentences are in `reporting.text`, the plots in `figures`."""
