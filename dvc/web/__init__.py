"""HTML pages that need nothing else: what they share, and galleries of pictures to be compared."""
