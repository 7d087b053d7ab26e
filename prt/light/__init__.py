"""What lights it: cubemaps, Haar wavelets, spherical harmonics, environment maps. Knows no renderer."""
