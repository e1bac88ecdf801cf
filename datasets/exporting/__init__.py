"""Export formats: how one episode becomes a part, and how parts become a dataset."""
