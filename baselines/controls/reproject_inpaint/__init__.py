"""Control: reprojection whose holes classical inpainting fills."""
