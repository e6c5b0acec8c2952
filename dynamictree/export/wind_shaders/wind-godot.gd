# Godot 4: the wind of one tree. A SubViewport with this script in the scene moves all meshes whose materials it lists:
# ShaderMaterials of wind-godot.gdshader, for tree-bones.glb. Import bones.exr uncompressed, without mipmaps.
extends SubViewport

@export var bones: Texture2D
@export var shader: Shader # wind-godot-poses.gdshader
@export var materials: Array[ShaderMaterial]
@export var speed := OWN_M_S # mean speed of the wind [m/s]
@export var offset_s := 0.0 # of this tree's wind from the others'

var seconds := 0.0
var pass_material := ShaderMaterial.new()

func _ready() -> void:
	size = Vector2i(3 * POSES_WIDTH, POSES_HEIGHT)
	disable_3d = true
	render_target_update_mode = UPDATE_ALWAYS
	pass_material.shader = shader
	pass_material.set_shader_parameter("bones", bones)
	var square := ColorRect.new()
	square.size = size
	square.material = pass_material
	add_child(square)
	for material in materials:
		material.set_shader_parameter("poses", get_texture())

func _process(delta: float) -> void:
	seconds += delta
	pass_material.set_shader_parameter("seconds", seconds + offset_s)
	pass_material.set_shader_parameter("speed", speed)
