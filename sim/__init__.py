"""Two humanoids in MuJoCo: tracking, contact, plausibility, pictures."""
