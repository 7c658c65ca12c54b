"""The search for missed, misnamed and false contacts in a refined contact graph."""
