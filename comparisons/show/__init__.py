"""What is shown of results: text, HTML, JSON and pictures."""
