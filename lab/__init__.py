"""The laboratory: comparisons, rivals, trainings and studies around the product."""
