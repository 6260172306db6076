"""The thesis, reproduced: what its chapters measure, and the document that shows it."""
