# Draws what a shader does to the vertices of a GLB as bytes of pictures, one pixel a vertex, and hands them to the page.
extends Node3D

const WIDTH := 64

func _ready() -> void:
	var arrays := first_surface("res://tree-bones.glb")
	var count: int = arrays[Mesh.ARRAY_VERTEX].size()
	var size := Vector2i(WIDTH, ceili(float(count) / WIDTH))
	var material := ShaderMaterial.new()
	material.shader = shader_of("res://probe.gdshader")
	material.set_shader_parameter("picture", Vector2(size))
	var view := viewport(size)
	view.add_child(points(arrays, material))
	var wind: SubViewport = load("res://wind-godot.gd").new()
	wind.bones = ImageTexture.create_from_image(texels("res://bones.bin"))
	wind.shader = shader_of("res://wind-godot-poses.gdshader")
	wind.materials = [material] as Array[ShaderMaterial]
	add_child(wind)
	wind.set_process(false)
	var pictures := []
	for run in JSON.parse_string(FileAccess.get_file_as_string("res://runs.json")):
		for axis in 3:
			wind.seconds = run[0]
			wind.speed = run[1]
			wind._process(0.0)
			material.set_shader_parameter("axis", axis)
			await RenderingServer.frame_post_draw
			await RenderingServer.frame_post_draw
			pictures.append(encoded(view.get_texture().get_image()))
	var uniforms := []
	for name in ["wind-godot.gdshader", "wind-godot-poses.gdshader"]:
		uniforms.append_array(shader_of("res://" + name).get_shader_uniform_list().map(func(uniform): return uniform.name))
	var readings := {
		"pictures": pictures,
		"vertices": Marshalls.raw_to_base64(arrays[Mesh.ARRAY_VERTEX].to_byte_array()),
		"uniforms": uniforms,
	}
	JavaScriptBridge.eval("window.readings = " + JSON.stringify(readings))

func first_surface(path: String) -> Array:
	var document := GLTFDocument.new()
	var state := GLTFState.new()
	document.append_from_buffer(FileAccess.get_file_as_bytes(path), "", state)
	var scene := document.generate_scene(state)
	return scene.find_children("*", "MeshInstance3D", true, false)[0].mesh.surface_get_arrays(0)

func shader_of(path: String) -> Shader:
	var shader := Shader.new()
	shader.code = FileAccess.get_file_as_string(path)
	return shader

# The width, then 32-bit floats: Godot's own reader of EXR starts threads, which this build of it lacks.
func texels(path: String) -> Image:
	var bytes := FileAccess.get_file_as_bytes(path)
	var width := bytes.decode_u32(0)
	var height := (bytes.size() - 4) / (12 * width)
	return Image.create_from_data(width, height, false, Image.FORMAT_RGBF, bytes.slice(4))

func viewport(size: Vector2i) -> SubViewport:
	var view := SubViewport.new()
	view.size = size
	view.own_world_3d = true
	view.render_target_update_mode = SubViewport.UPDATE_ALWAYS
	add_child(view)
	var camera := Camera3D.new()
	view.add_child(camera)
	camera.current = true
	return view

func points(arrays: Array, material: Material) -> MeshInstance3D:
	var given := []
	given.resize(Mesh.ARRAY_MAX)
	given[Mesh.ARRAY_VERTEX] = arrays[Mesh.ARRAY_VERTEX]
	given[Mesh.ARRAY_TEX_UV2] = arrays[Mesh.ARRAY_TEX_UV2]
	var instance := MeshInstance3D.new()
	instance.mesh = ArrayMesh.new()
	instance.mesh.add_surface_from_arrays(Mesh.PRIMITIVE_POINTS, given)
	instance.custom_aabb = AABB(Vector3.ONE * -1000, Vector3.ONE * 2000)
	instance.material_override = material
	return instance

func encoded(picture: Image) -> String:
	picture.convert(Image.FORMAT_RGB8)
	return Marshalls.raw_to_base64(picture.get_data())
