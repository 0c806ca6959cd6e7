"""What the report shows in addition to the findings."""
