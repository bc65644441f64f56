"""Doubts about the data: outliers, changes of the object, likely mistakes, too little variety; and lower bounds on mu_c."""
