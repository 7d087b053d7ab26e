"""Everything that shoots rays: transport recording, references, denoising, procedural environments."""
