"""What is looked at: scenes, materials, cameras, the G-buffer. No light lives here."""
