"""The paper's experiments, reproduced as tables, figures and a page; and a study of how far the estimates can be relied on."""
