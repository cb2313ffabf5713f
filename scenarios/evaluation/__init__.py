"""What estimates are worth: measures, tuning, bounds, intervals."""
