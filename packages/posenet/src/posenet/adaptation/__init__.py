"""A trained model learns from unlabeled images of somebody's camera: its own verified poses are the labels"""
