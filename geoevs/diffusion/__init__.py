"""Parts of latent diffusion that methods share: autoencoder, denoiser, prior, sampling."""
