"""How the model is made and judged: the data set 4DTree, training and evaluation. `dynamictree` never imports it."""
