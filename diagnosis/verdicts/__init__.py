"""The result of a diagnosis as values: verdict, candidates, localisation, experiment design."""
