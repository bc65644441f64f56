"""The motion of a pushed object: quasi-static model, limit surfaces, predictions and stable pushes."""
