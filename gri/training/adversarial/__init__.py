"""The paper's min-max game (Sec. V-B): `airl` trains encoder, reward and policy, `discriminator` judges them."""
