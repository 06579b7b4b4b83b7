"""What every rasterizer here shares with gsplat, so that the same Gaussians give its picture."""

ALPHA_THRESHOLD = 1 / 255
"""A Gaussian is not drawn in pixels where its alpha is lower."""

ALPHA_CAP = 0.99
"""No Gaussian covers a pixel more than this."""

TRANSMITTANCE_THRESHOLD = 1e-4
"""A pixel is finished before the Gaussian that would let no more than this through."""

BLUR = 0.3
"""Square pixels added to the variance of every footprint, so that none falls between pixels."""

NEAR_PLANE = 0.01
"""Metres; Gaussians whose centre is not beyond it are not drawn."""

FRAME_MARGIN = 0.15
"""Margin around the frame, as a part of its side. Beyond it the projection's slope is taken as it
is at the margin: its linearisation would blow up footprints."""

SH_C0 = 0.28209479177387814
SH_C1 = 0.4886025119029199
