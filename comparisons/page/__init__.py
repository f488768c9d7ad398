"""The page toolkit: blocks, template and picture style; knows no result."""
