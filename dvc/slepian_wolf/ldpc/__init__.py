"""Slepian-Wolf coding of many bit planes together, by syndromes whose length the encoder chooses alone."""
