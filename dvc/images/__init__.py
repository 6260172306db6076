"""An embedded coder of pictures and maps: wavelets that may stop at edges, zerotrees, and codes of edges."""
