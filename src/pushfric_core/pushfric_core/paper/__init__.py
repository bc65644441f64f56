"""The paper's experiments, reproduced as tables, figures and a page."""
