"""What networks are made of: hash grid, encodings, MLP. Knows no scene and no renderer."""
