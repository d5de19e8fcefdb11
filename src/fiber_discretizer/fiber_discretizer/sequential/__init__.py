"""Sequential discretization: one robot at a time, beside the segments the others have by then."""
