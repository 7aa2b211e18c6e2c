"""Training of InterGen (Sec. 5.1): ``config`` says what, ``train`` does it.

Nothing is imported here, so that configurations can be read without torch.
"""
