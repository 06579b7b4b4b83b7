"""EmerNeRF: static, dynamic and flow hash fields that tell the moving from the still unaided."""
