"""From score rows to tables, figures and a manifest."""
