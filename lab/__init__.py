"""Development of the model: the data set 4DTree, training and evaluation. `dynamictree` never imports this package."""
