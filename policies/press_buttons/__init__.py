"""What is particular to pressing buttons: the features that the denoiser sees."""
