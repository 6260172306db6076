"""The codec of chapter 3: views in, a stream out, and any view from it."""
