"""Transformer blocks of VGGT and of the DINOv2 encoder that its published weights embed with.

Parameters are named as in the public checkpoint.
"""

import torch
from torch import Tensor, nn
from torch.nn import functional

MLP_RATIO = 4
ROTARY_BASE = 100.0

Tables = tuple[Tensor, Tensor]


def rotary_tables(
    rows: int,
    columns: int,
    specials: int,
    head_dim: int,
    like: Tensor,  # any shape
) -> Tables:
    """Cosines and sines that turn queries and keys by their patch's place in the image.

    Half of a head's channels turn with the row and half with the column, both counted from 1;
    special tokens come first and do not turn.

    Args:
        rows: patches down.
        columns: patches across.
        specials: tokens before the patches.
        head_dim: channels of one attention head, a multiple of 4.
        like: whose device and type the tables take.

    Returns:
        Both (specials + rows * columns, head_dim).
    """
    half = head_dim // 2
    places = torch.cartesian_prod(
        torch.arange(1, rows + 1, device=like.device),
        torch.arange(1, columns + 1, device=like.device),
    )
    places = functional.pad(places, (0, 0, specials, 0)).float()
    exponents = torch.arange(0, half, 2, device=like.device) / half
    angles = places[:, :, None] * ROTARY_BASE**-exponents
    angles = angles.repeat(1, 1, 2).flatten(1)
    return angles.cos().to(like.dtype), angles.sin().to(like.dtype)


def rotate(
    tokens: Tensor,  # [B, heads, N, D]
    tables: Tables,  # each [N, D]
) -> Tensor:
    """Turn the channel pairs (i, i + D / 4) of either half by the tables' angles."""
    cosines, sines = tables
    first, second = tokens.unflatten(-1, (2, 2, -1)).unbind(-2)
    turned = torch.stack([-second, first], dim=-2).flatten(-3)
    return tokens * cosines + turned * sines


class Attention(nn.Module):
    """Multi-head self-attention; `normed` puts a LayerNorm on the heads' queries and keys."""

    def __init__(self, dim: int, heads: int, normed: bool) -> None:
        super().__init__()
        self.heads = heads
        self.qkv = nn.Linear(dim, 3 * dim)
        self.q_norm = nn.LayerNorm(dim // heads) if normed else nn.Identity()
        self.k_norm = nn.LayerNorm(dim // heads) if normed else nn.Identity()
        self.proj = nn.Linear(dim, dim)

    def forward(
        self,
        tokens: Tensor,  # [B, N, C]
        tables: Tables | None,  # each [N, C / heads]
    ) -> Tensor:
        """(B, N, C) tokens, each mixed from all tokens of its batch entry."""
        qkv = self.qkv(tokens).unflatten(-1, (3, self.heads, -1)).permute(2, 0, 3, 1, 4)
        queries, keys, values = qkv.unbind()
        queries, keys = self.q_norm(queries), self.k_norm(keys)
        if tables is not None:
            queries, keys = rotate(queries, tables), rotate(keys, tables)
        mixed = functional.scaled_dot_product_attention(queries, keys, values)
        return self.proj(mixed.transpose(1, 2).flatten(2))


class Mlp(nn.Module):
    """Two layers with a GELU between."""

    def __init__(self, dim: int) -> None:
        super().__init__()
        self.fc1 = nn.Linear(dim, MLP_RATIO * dim)
        self.fc2 = nn.Linear(MLP_RATIO * dim, dim)

    def forward(self, tokens: Tensor) -> Tensor:  # [B, N, C] to the same
        """(B, N, C) tokens, each mapped by itself."""
        return self.fc2(functional.gelu(self.fc1(tokens)))


class LayerScale(nn.Module):
    """A learned gain for each channel."""

    def __init__(self, dim: int, initial: float) -> None:
        super().__init__()
        self.gamma = nn.Parameter(torch.full((dim,), initial))

    def forward(self, tokens: Tensor) -> Tensor:  # [B, N, C] to the same
        """(B, N, C) tokens times their channels' gains."""
        return tokens * self.gamma


class Block(nn.Module):
    """Pre-norm attention and MLP, each scaled and added.

    Args:
        dim: channels.
        heads: of the attention.
        layer_scale: initial gain of what is added.
        normed: whether queries and keys are (see `Attention`).
        eps: of the two LayerNorms; VGGT's own blocks and DINOv2's differ.
    """

    def __init__(
        self, dim: int, heads: int, layer_scale: float, normed: bool = True, eps: float = 1e-5
    ) -> None:
        super().__init__()
        self.norm1 = nn.LayerNorm(dim, eps)
        self.attn = Attention(dim, heads, normed)
        self.ls1 = LayerScale(dim, layer_scale)
        self.norm2 = nn.LayerNorm(dim, eps)
        self.mlp = Mlp(dim)
        self.ls2 = LayerScale(dim, layer_scale)

    def forward(
        self,
        tokens: Tensor,  # [B, N, C]
        tables: Tables | None = None,  # each [N, C / heads]
    ) -> Tensor:
        """(B, N, C) tokens after attention and MLP."""
        tokens = tokens + self.ls1(self.attn(self.norm1(tokens), tables))
        return tokens + self.ls2(self.mlp(self.norm2(tokens)))


class PatchEmbedding(nn.Module):
    """One linear map of every patch's pixels."""

    def __init__(self, patch_size: int, dim: int) -> None:
        super().__init__()
        self.proj = nn.Conv2d(3, dim, patch_size, patch_size)

    def forward(self, images: Tensor) -> Tensor:  # [B, 3, H, W], normalised
        """(B, patches, C) embeddings of the patches, row by row."""
        return self.proj(images).flatten(2).transpose(1, 2)


class DinoEncoder(nn.Module):
    """DINOv2 with registers: (B, 3, H, W) normalised images to (B, patches, C) features.

    Args:
        patch_size: pixels.
        dim: channels.
        depth: blocks.
        heads: of every block.
        registers: register tokens.
        grid: patches a side of the learned positions, resampled to the image's own grid.
    """

    def __init__(
        self, patch_size: int, dim: int, depth: int, heads: int, registers: int, grid: int
    ) -> None:
        super().__init__()
        self.grid = grid
        self.patch_embed = PatchEmbedding(patch_size, dim)
        self.cls_token = nn.Parameter(torch.zeros(1, 1, dim))
        self.register_tokens = nn.Parameter(torch.zeros(1, registers, dim))
        self.pos_embed = nn.Parameter(torch.zeros(1, 1 + grid**2, dim))
        self.blocks = nn.ModuleList(
            Block(dim, heads, 1.0, normed=False, eps=1e-6) for _ in range(depth)
        )
        self.norm = nn.LayerNorm(dim, 1e-6)

    def forward(self, images: Tensor) -> Tensor:  # [B, 3, H, W]
        """(B, patches, C) features of the patches, row by row."""
        patches = self.patch_embed(images)
        size = self.patch_embed.proj.stride[0]
        patches = patches + self._positions(images.shape[-2] // size, images.shape[-1] // size)
        specials = torch.cat([self.cls_token + self.pos_embed[:, :1], self.register_tokens], dim=1)
        tokens = torch.cat([specials.expand(len(images), -1, -1), patches], dim=1)
        for block in self.blocks:
            tokens = block(tokens)
        return self.norm(tokens[:, specials.shape[1] :])

    def _positions(self, rows: int, columns: int) -> Tensor:
        """(1, rows * columns, C): the patches' learned positions."""
        learned = self.pos_embed[:, 1:]
        if rows == columns == self.grid:
            return learned
        image = learned.unflatten(1, (self.grid, self.grid)).permute(0, 3, 1, 2)
        image = functional.interpolate(image, (rows, columns), mode="bicubic", antialias=True)
        return image.flatten(2).transpose(1, 2)
