"""What the generator trains on: condition-target pairs and artifact masks (sections 3.2, 3.4)."""
