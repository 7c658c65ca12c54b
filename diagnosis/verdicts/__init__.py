"""The report of a diagnosis as values: verdict, probabilities, places of the gap, closure, recommended experiment."""
